// What is used of Swagger UI, which comes without types.
declare module 'swagger-ui-dist/swagger-ui-es-bundle.js' {
  interface Options {
    dom_id: string;
    url: string;
    deepLinking: boolean;
    displayRequestDuration: boolean;
    defaultModelsExpandDepth: number;
    docExpansion: 'list' | 'full' | 'none';
    tryItOutEnabled: boolean;
    validatorUrl: null;
    persistAuthorization: boolean;
  }
  export default function SwaggerUI(options: Options): unknown;
}
